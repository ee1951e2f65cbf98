"""Tests in a headless Chromium: a package, so that one browser serves all its files in a process."""
