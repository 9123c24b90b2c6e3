"""Numbers of a scene estimated again and again while it is felt, in a process of their own."""
