"""`relational` with samples by hindsight instead of detours: `python -m research.hindsight`."""
