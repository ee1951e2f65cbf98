"""What a person may ask of a running test: the kinds, giving one, obeying one. No route, no option."""
