"""Plots, figures and reports of runs. No ROS."""
