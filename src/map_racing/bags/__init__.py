"""ROS 1 bags: records, messages, topics, recorded driving."""
