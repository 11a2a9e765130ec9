"""Where a search may begin: what the catalogue and direct tests of the readings suggest."""
