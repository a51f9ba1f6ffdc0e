"""What the model misses: residuals, hypotheses, their test, the extended model."""
