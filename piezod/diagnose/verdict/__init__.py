"""What is said: evidence, wording, and the extended model."""
