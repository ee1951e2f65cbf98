"""Alarms after ISA-18.2: their states, and trouble of the rig as a condition. Pure: stores nothing."""
