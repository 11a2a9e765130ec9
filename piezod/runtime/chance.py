"""Random numbers of the operating system."""

import secrets

below = secrets.randbelow
"""A random number from 0 to below a limit, as `secrets.randbelow`."""
token = secrets.token_hex
"""A random text of hexadecimal digits, as `secrets.token_hex`."""
