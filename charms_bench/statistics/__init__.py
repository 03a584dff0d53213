"""How certain a value is: intervals, paired comparison, divergences, corrections."""
