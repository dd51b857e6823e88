"""`relational`, cloning from states under tested assumptions, and `redraw`, its student, which observes pictures."""
