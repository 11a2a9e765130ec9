"""Which effects stay: the stepwise search, its criterion, and the significance of what it finds."""
