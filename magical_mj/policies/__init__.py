"""Policies: their interface, the built-in agents, the scripted expert, and how policies are loaded."""
