"""Tools that use sessions: check, init, record, validate, demo, safe stop, support bundle."""
