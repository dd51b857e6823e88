"""Reports: tables, figures and statistics of evaluations."""
