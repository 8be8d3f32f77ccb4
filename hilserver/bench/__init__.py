"""Every figure quoted in the README, measured with its reference in the same run."""
