"""Units at the end of key names."""

_UNITS = {
    "V_per_s2": "V/s\N{SUPERSCRIPT TWO}",
    "V_per_s": "V/s",
    "N_per_s": "N/s",
    "Hz": "Hz",
    "V": "V",
    "N": "N",
    "A": "A",
    "F": "F",
    "W": "W",
    "s": "s",
    "ms": "ms",
    "us": "\N{MICRO SIGN}s",
    "h": "h",
    "MB": "MB",
    "degC": "\N{DEGREE SIGN}C",
    "seconds": "s",
    "samples": "samples",
}


def unit_of(key: str) -> str:
    """The unit in the name of a key, such as V/s for `slew_V_per_s`; empty: no unit."""
    for suffix, unit in _UNITS.items():
        if key.endswith(f"_{suffix}"):
            return unit
    return ""
