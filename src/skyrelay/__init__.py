"""SkyRelay: UAV relays for connected vehicles, selected in the open and flown by learned policies."""

__version__ = "0.1.0"
