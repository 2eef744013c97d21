"""Run-time assurance: monitors of a perception, and the switch that acts on their alarms."""
