"""Definitions of PlanSys2's messages, for bags that do not carry their own: those of ROS 2 before Iron."""

PLANSYS2 = {
    "plansys2_msgs/msg/Knowledge": "string[] instances\nstring[] predicates\nstring[] functions\nstring goal\n",
    "plansys2_msgs/msg/PlanItem": "float32 time\nstring action\nfloat32 duration\n",
    "plansys2_msgs/msg/Plan": "PlanItem[] items\n",
    "plansys2_msgs/msg/ActionExecutionInfo": (
        "int8 status\n"
        "builtin_interfaces/Time start_stamp\n"
        "builtin_interfaces/Time status_stamp\n"
        "string action_full_name\n"
        "string action\n"
        "string[] arguments\n"
        "builtin_interfaces/Duration duration\n"
        "float32 completion\n"
        "string message_status\n"
    ),
    "plansys2_msgs/msg/ActionExecution": (
        "int16 type\n"
        "string node_id\n"
        "string action\n"
        "string[] arguments\n"
        "bool success\n"
        "float32 completion\n"
        "string status\n"
    ),
}
