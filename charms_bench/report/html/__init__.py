"""A report as one HTML file: tables, figures, replays."""
