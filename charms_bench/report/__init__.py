"""Tables, and the views that draw them: for a terminal, a page, a report, or a notebook."""
