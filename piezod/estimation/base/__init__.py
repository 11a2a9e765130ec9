"""The smooth base: a fine grid of plays before a fine force law, and its reduction to few operators."""
