"""x-magical's suite: SweepToTop with its environments and its expert, and its ids of all other tasks."""
