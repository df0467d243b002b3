"""Recorded flights, one file per format: columns first, objects never in the loop."""
