"""The plant a second time, in C, and the conformance vectors that both reproduce."""
