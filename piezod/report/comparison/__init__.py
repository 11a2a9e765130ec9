"""Model against measurement: simulated outputs beside a measured one, and the whiteness test of a residual."""
