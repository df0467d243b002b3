"""The vocabulary: rotations, the Earth, measurements and estimates. No I/O, no statistics."""
