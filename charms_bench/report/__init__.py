"""The tables, figures and HTML reports of a run."""
