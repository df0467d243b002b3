"""The service's configuration: YAML in, frozen settings out, and what a reload may change.

Settings of the estimator stand beside the code that reads them (``core.settings``); no device, no
socket and no estimate here.
"""
