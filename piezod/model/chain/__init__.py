"""The chain from command to reading, assembled from the effects of a model: over a record, and tick by tick."""
