"""A method of our own: it infers a goal from the ends of demonstrations, and plans in the simulation to reach it."""
