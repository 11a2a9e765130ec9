"""A foreign implementation as judge: `law.py` simulates a `model.yaml` from the pages alone, without piezod."""
