"""Places at which the given model is wrong: in time, frequency, voltage, rate, history."""
