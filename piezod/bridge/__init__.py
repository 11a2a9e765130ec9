"""Companion processes that carry the values of a running daemon to other systems: MQTT and OPC UA."""
