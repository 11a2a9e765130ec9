"""A diagnosis for people: text for a terminal, and one page."""
