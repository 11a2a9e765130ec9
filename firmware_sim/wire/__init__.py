"""The connectors of the emulated device: TCP, RTU on a pty, lines on a pty."""
