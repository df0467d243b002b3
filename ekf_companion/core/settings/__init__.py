"""What a user may set, and the numbers that the kernel makes of it.

Nothing here runs while the filter does, but the Earth's field that ``field`` adds to fixes.
"""
