"""The concealed plant: the chain from command to reading, the commands that drive it, and the sampling."""
