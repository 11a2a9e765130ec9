"""The service around the control process: socket, status, metrics, systemd, reload, comparison with the model."""
