"""The EVM as SkyRelay runs it: London rules, in Python."""
