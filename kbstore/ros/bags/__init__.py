"""Bags without ROS: recordings of PlanSys2 and ROSPlan become knowledge bases, and histories become MCAP files."""
