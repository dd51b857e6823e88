"""A method in a package of its own: it infers a goal from the ends of demonstrations, and plans to reach it."""
