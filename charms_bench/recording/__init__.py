"""What is kept of a simulation: the rows, and the events of every vehicle that they count."""
