"""The pure core: from samples to classified tissue, in stages that follow the data.

``streams`` → ``contact`` → ``law`` → ``estimation`` → ``classification``, composed by
``pipeline``. Nothing here knows ROS, a clock or a file.
"""
