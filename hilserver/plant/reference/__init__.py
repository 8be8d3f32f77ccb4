"""A second implementation of the plant, in C, and the conformance vectors both reproduce."""
