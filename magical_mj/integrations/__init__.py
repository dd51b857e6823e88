"""Plug-ins for other projects' tools. Each needs that project installed; nothing in the package imports them."""
