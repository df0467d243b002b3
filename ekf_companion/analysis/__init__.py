"""Evaluation of estimates: scores, comparisons of filters, observability, and all figures.

It reads estimates and recordings; no estimator imports it.
"""
