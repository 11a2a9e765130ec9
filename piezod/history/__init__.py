"""Models of a bench over time: their lineage, their parameters with intervals, and the changes from model to model."""
