"""What is not about driving: portable mathematics, compilation, random words, files, processes."""
