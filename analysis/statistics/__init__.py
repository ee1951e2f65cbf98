"""Statistics of sets: baseline, distance, limits, rules, trend. No waveforms."""
