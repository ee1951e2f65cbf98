"""Numbers that decide: baseline, distance, limits, rules, trend. Nothing of waves."""
