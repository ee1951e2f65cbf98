"""``solimon reproduce``: reproduce the paper's figures and tables and list the deviations."""
