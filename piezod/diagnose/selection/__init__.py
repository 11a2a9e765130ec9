"""Selection of effects: the stepwise search, its acceptance rule, and the significance of its results."""
