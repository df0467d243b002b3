"""What the estimator keeps: structs declared once, as C for the compiler and as memory for Python.

No equation and no decision; ``signatures`` makes the compiler's headers of all that is compiled.
"""
