"""Notifications of alarms to people and programs elsewhere; a dead receiver delays nothing."""
