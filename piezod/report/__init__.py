"""Pages for people: figures and words, self-contained, from recordings and results."""
