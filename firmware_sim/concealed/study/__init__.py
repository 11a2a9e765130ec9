"""A concealed study: the plan of its cases, their drawing, and the sealing of their truth."""
