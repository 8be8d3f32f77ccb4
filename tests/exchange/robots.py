"""Five robots in the files of others, two of them after public ones, written anew."""

from hilserver.plant.parameters import RobotParameters

TURTLEBOT = """\
controller_manager:
  ros__parameters:
    update_rate: 50
    use_sim_time: False
    diffdrive_controller: {type: diff_drive_controller/DiffDriveController}

diffdrive_controller:
  ros__parameters:
    left_wheel_names: ["left wheel motor"]
    right_wheel_names: ["right wheel motor"]
    wheel_separation: 0.16
    wheel_radius: 0.033
    wheel_separation_multiplier: 1.112
    pose_covariance_diagonal: [0.001, 0.001, 0.001, 0.001, 0.001, 0.01]
    open_loop: false
    linear: {x: {max_velocity: 0.5}}
"""
HUSKY = """\
/**/platform_velocity_controller:
  ros__parameters:
    type: diff_drive_controller/DiffDriveController
    left_wheel_names: [front_left_wheel_joint, rear_left_wheel_joint]
    right_wheel_names: [front_right_wheel_joint, rear_right_wheel_joint]
    wheel_separation: 0.5708
    wheels_per_side: 2
    wheel_radius: 0.1651
    wheel_separation_multiplier: 1.875
    enable_odom_tf: true
    linear.x.has_velocity_limits: true
    linear.x.max_velocity: 1.0
"""
OF_ITS_MAKER = """\
/**:
  turtlebot3_node:
    ros__parameters:
      enable_stamped_cmd_vel: true
      wheels:
        separation: 0.160
        radius: 0.033
/**:
  diff_drive_controller:
    ros__parameters:
      odometry: {publish_tf: true, frame_id: odom}
"""
FOUR_ROLLERS = """\
/**:
  mecanum_controller:
    ros__parameters:
      use_stamped_vel: false
      kinematics:
        base_frame_offset: {x: 0.0, y: 0.0, theta: 0.0}
        wheels_radius: 0.05
        sum_of_robot_center_projection_on_X_Y_axis: 0.4704
"""
BURGER = """\
<robot name="burger">
  <link name="base_footprint"/>
  <link name="base_link"/>
  <joint name="base_joint" type="fixed">
    <parent link="base_footprint"/><child link="base_link"/><origin xyz="0 0 0.010"/>
  </joint>
  <joint name="left_joint" type="continuous">
    <parent link="base_link"/><child link="left_wheel"/>
    <origin xyz="0.0 0.08 0.023" rpy="-1.57 0 0"/><axis xyz="0 0 1"/>
  </joint>
  <link name="left_wheel">
    <visual><geometry><mesh filename="left_tire.stl"/></geometry></visual>
    <collision><geometry><cylinder length="0.018" radius="0.033"/></geometry></collision>
  </link>
  <joint name="right_joint" type="continuous">
    <parent link="base_link"/><child link="right_wheel"/>
    <origin xyz="0.0 -0.080 0.023" rpy="-1.57 0 0"/><axis xyz="0 0 1"/>
  </joint>
  <link name="right_wheel">
    <collision><geometry><cylinder length="0.018" radius="0.033"/></geometry></collision>
  </link>
  <joint name="scan_joint" type="continuous">
    <parent link="base_link"/><child link="scan"/><axis xyz="0 0 1"/>
  </joint>
  <link name="scan"/>
</robot>
"""
DIFFERENTIAL = RobotParameters(
    wheel_radius_m=0.04,
    wheelbase_m=None,
    track_m=0.2,
    icr_offset_m=0.0,
    rotation_gain="geometric_diff",
)
SKID = RobotParameters(icr_offset_m=0.0)
MECANUM = RobotParameters(
    drive="mecanum",
    wheel_radius_m=0.05,
    wheelbase_m=0.25,
    track_m=0.36,
    icr_offset_m=0.0,
)


def robot_of(described):
    """The robot that a file describes."""
    gain = described.rotation_gain
    return RobotParameters(**described.plant, rotation_gain=gain)
