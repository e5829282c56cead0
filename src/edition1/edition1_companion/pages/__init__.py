"""A module or folder for each notebook, which nothing else imports."""
