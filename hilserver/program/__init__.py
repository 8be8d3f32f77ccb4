"""One harness for every program: signals, exit codes, children, workers, progress.

A program writes its own start and nothing else::

    def main() -> int:
        with children.running(...):       # ended with the context, at last by force
            return EXIT_DONE

    sys.exit(harness.run(main))           # errors are sentences, signals end it with code 0

`ending` is about signals before and beside an event loop, `event_loop` about them inside one.
"""
