"""From decisions to findings: values, words, gain, detectable sizes, the patch."""
