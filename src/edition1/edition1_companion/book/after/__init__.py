"""What runs after the notebooks: scorecard, index of the papers, the site, comparisons of runs."""
