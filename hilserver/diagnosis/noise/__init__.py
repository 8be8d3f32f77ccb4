"""The noise of each channel: model, fit, whitening."""
