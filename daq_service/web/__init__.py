"""The web service: REST, server-sent events, live waveforms and the dashboard."""
