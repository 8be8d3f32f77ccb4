"""Residuals as whitened columns: problem, scores, fits, intervals."""
