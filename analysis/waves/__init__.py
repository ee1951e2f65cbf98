"""A solitary-wave record becomes pulses, features and quality flags. No statistics over sets."""
