"""``solimon reproduce``: the paper's figures and tables from one test and the models, with the deviations."""
