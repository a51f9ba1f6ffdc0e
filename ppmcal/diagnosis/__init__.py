"""Unmodelled effects: residuals, hypotheses, their test, the extended model."""
