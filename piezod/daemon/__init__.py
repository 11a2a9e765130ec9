"""The service around the loop: processes, recording, checks; everything that may wait."""
