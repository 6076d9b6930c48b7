"""The one judge: sets up a world in physics, performs actions in it, reads poses, and judges the result of each."""
