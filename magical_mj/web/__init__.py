"""Playing in a browser: the page, the data about the benchmark that it needs, and a server that simulates for it."""
