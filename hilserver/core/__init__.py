"""What daemon, links and tools share: state machine, inputs, events, snapshots, the clock."""
