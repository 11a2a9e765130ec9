"""Where simulation and recording differ, which physics that is, and the model that has it."""
