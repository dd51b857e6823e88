"""A method of our own: it infers the goal from how demonstrations end, and plans in the simulator towards it."""
