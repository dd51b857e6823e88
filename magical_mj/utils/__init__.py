"""Utilities for all layers: errors, files, imports of users' code, optional dependencies, parallel work."""
