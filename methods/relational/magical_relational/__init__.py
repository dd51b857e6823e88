"""`relational`, which clones from states under tested assumptions, and `redraw`, its student that sees pictures."""
