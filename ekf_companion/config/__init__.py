"""The service's configuration: YAML in, frozen settings out, and what a reload may change.

The estimator's settings stand in ``core.settings``, beside the code that reads them. No device, no
socket and no estimate here.
"""
