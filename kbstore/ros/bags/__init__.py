"""Bags, without ROS: imports recordings of PlanSys2 and ROSPlan, and exports histories as MCAP files."""
