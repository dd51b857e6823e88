"""A method in a separate package. It infers a goal from the final states of demonstrations, and plans to reach it."""
