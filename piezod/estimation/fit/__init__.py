"""Columns, normal equations, Gauss-Newton steps within bounds, and the quadratic program."""
