"""The live page of a running bench: one reader of the ring log, shared by all viewers."""
