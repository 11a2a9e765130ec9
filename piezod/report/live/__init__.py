"""The live page: one reader of the ring log, and as many viewers as look at it; no tick knows of any of them."""
