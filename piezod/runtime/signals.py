"""Handlers of signals."""

import signal

handle = signal.signal
"""Set the handler of a signal, as `signal.signal`."""
handler = signal.getsignal
"""Handler of a signal, as `signal.getsignal`."""
