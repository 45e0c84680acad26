"""A report of one run or of many: tables, figures and claims in one HTML file that needs no network."""
