"""The law of flight, the guard of the links, and what a UAV sees of all that: for any array library."""
