"""From decisions to findings: values, words, gain, smallest sizes, the patch."""
