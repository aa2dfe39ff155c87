"""Scenarios, traces and policies that ship with the package."""
