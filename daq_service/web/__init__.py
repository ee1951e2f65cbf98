"""The web service: application, server and guards; resources, answers and streams in rooms of their own."""
