"""What one asks of estimates once they are there: scores, comparisons, figures, observability.

Reads estimates and recordings; nothing that estimates imports it.
"""
