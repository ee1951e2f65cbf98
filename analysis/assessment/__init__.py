"""Assessment of one set after another at a transducer: state, diagnosis, quality of the baseline."""
