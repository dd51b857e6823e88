"""Exports of demonstrations to the formats of other libraries, and their command `magical-mj demos export`."""
