"""Playing in a browser: the page, its data about the benchmark, and a server that simulates for it."""
