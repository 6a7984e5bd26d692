"""The description of an arm with a mimic joint, a sensor and an input."""

ARM = """\
<robot name="arm">
  <link name="base"/><link name="upper"/><link name="finger"/><link name="thumb"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/>
    <origin xyz="1 2 3" rpy="0 0 1.5"/>
    <axis xyz="0 0 1"/>
    <limit lower="-1" upper="2" velocity="3" effort="4"/>
  </joint>
  <joint name="grip" type="prismatic">
    <parent link="upper"/><child link="finger"/>
    <limit upper="0.1" velocity="1" effort="1"/>
  </joint>
  <joint name="grip2" type="prismatic">
    <parent link="upper"/><child link="thumb"/>
    <mimic joint="grip" multiplier="-1" offset="0.5"/>
    <limit upper="0.1" velocity="1" effort="1"/>
  </joint>
  <ros2_control name="arm" type="system">
    <hardware>
      <plugin> canopen_ros2_control/RobotSystem </plugin>
      <param name="bus_config">x.yml</param>
    </hardware>
    <joint name="shoulder">
      <param name="device_name">drive</param>
      <command_interface name="position">
        <param name="min">-1.5</param><param name="max">1.5</param><param name="initial_value">0.25</param>
      </command_interface>
      <state_interface name="position"/>
    </joint>
    <joint name="grip2"><state_interface name="position"/></joint>
    <sensor name="force"><state_interface name="fx"/></sensor>
    <gpio name="io"><command_interface name="out"/></gpio>
  </ros2_control>
</robot>
"""
