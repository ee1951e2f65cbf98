"""A test, or some hours of it, as one page of HTML: reads alone, prints on A4, refers to nothing outside."""
