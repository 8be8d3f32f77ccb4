"""One harness for every program: signals, exit codes, children, workers, progress.

A program contains only its own start::

    def main() -> int:
        with children.running(...):       # ended with the context, if need be by force
            return EXIT_DONE

    sys.exit(harness.run(main))           # errors are sentences, signals end it with code 0

`ending` handles signals before and outside an event loop, `event_loop` inside one.
"""
