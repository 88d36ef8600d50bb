// Stand-ins for ROS 2 messages, with the fields of their public definitions that the exported node uses.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#define STUB_MESSAGE(type) \
  using SharedPtr = std::shared_ptr<type>; \
  using ConstSharedPtr = std::shared_ptr<const type>

namespace builtin_interfaces::msg
{
struct Time
{
  std::int32_t sec = 0;
  std::uint32_t nanosec = 0;
};
}  // namespace builtin_interfaces::msg

namespace std_msgs::msg
{
struct Header
{
  builtin_interfaces::msg::Time stamp;
  std::string frame_id;
};
struct Bool
{
  STUB_MESSAGE(Bool);
  bool data = false;
};
struct Int32
{
  STUB_MESSAGE(Int32);
  std::int32_t data = 0;
};
struct Float64MultiArray
{
  STUB_MESSAGE(Float64MultiArray);
  std::vector<double> data;
};
inline std::istream & operator>>(std::istream & in, Header & header)
{
  double at = 0.0;
  in >> at;
  header.stamp.sec = static_cast<std::int32_t>(at);
  header.stamp.nanosec = static_cast<std::uint32_t>(1e9 * (at - header.stamp.sec));
  return in;
}
inline std::istream & operator>>(std::istream & in, Bool & message) {return in >> message.data;}
inline std::istream & operator>>(std::istream & in, Float64MultiArray & message)
{
  for (double number; in >> number; ) {message.data.push_back(number);}
  return in;
}
inline std::ostream & operator<<(std::ostream & out, const Int32 & message) {return out << message.data;}
inline std::ostream & operator<<(std::ostream & out, const Float64MultiArray & message)
{
  for (double number : message.data) {out << number << ' ';}
  return out;
}
}  // namespace std_msgs::msg

namespace geometry_msgs::msg
{
struct Vector3
{
  double x = 0.0, y = 0.0, z = 0.0;
};
using Point = Vector3;
struct Quaternion
{
  double x = 0.0, y = 0.0, z = 0.0, w = 1.0;
};
struct Pose
{
  Point position;
  Quaternion orientation;
};
struct Twist
{
  Vector3 linear, angular;
};
struct PoseWithCovariance
{
  Pose pose;
};
struct TwistWithCovariance
{
  Twist twist;
};
struct Wrench
{
  Vector3 force, torque;
};
struct WrenchStamped
{
  STUB_MESSAGE(WrenchStamped);
  std_msgs::msg::Header header;
  Wrench wrench;
};
struct PointStamped
{
  STUB_MESSAGE(PointStamped);
  std_msgs::msg::Header header;
  Point point;
};
inline std::istream & operator>>(std::istream & in, Vector3 & v) {return in >> v.x >> v.y >> v.z;}
inline std::istream & operator>>(std::istream & in, Quaternion & q)
{
  double yaw = 0.0;
  in >> yaw;
  q.z = std::sin(0.5 * yaw);
  q.w = std::cos(0.5 * yaw);
  if (yaw > 1000.0) {q.z = q.w = 0.0;}  // nobody has set it
  return in;
}
inline std::istream & operator>>(std::istream & in, PointStamped & message) {return in >> message.header >> message.point;}
inline std::ostream & operator<<(std::ostream & out, const WrenchStamped & message)
{
  const Vector3 & f = message.wrench.force, & m = message.wrench.torque;
  return out << message.header.frame_id << ' ' << f.x << ' ' << f.y << ' ' << f.z << ' ' << m.x << ' ' << m.y << ' ' << m.z;
}
}  // namespace geometry_msgs::msg

namespace nav_msgs::msg
{
struct Odometry
{
  STUB_MESSAGE(Odometry);
  std_msgs::msg::Header header;
  std::string child_frame_id;
  geometry_msgs::msg::PoseWithCovariance pose;
  geometry_msgs::msg::TwistWithCovariance twist;
};
// stamp, position, yaw, linear and angular velocity
inline std::istream & operator>>(std::istream & in, Odometry & message)
{
  geometry_msgs::msg::Pose & pose = message.pose.pose;
  in >> message.header >> pose.position >> pose.orientation;
  return in >> message.twist.twist.linear >> message.twist.twist.angular;
}
}  // namespace nav_msgs::msg

namespace sensor_msgs::msg
{
struct Range
{
  STUB_MESSAGE(Range);
  std_msgs::msg::Header header;
  float field_of_view = 0.0f, min_range = 0.2f, max_range = 4.0f, range = 0.0f;
};
struct Imu
{
  STUB_MESSAGE(Imu);
  std_msgs::msg::Header header;
  std::array<double, 9> orientation_covariance{};
  geometry_msgs::msg::Quaternion orientation;
  geometry_msgs::msg::Vector3 angular_velocity;
};
inline std::istream & operator>>(std::istream & in, Range & message)
{
  std::string text;
  in >> message.header >> text;
  message.range = std::stof(text);
  return in;
}
inline std::istream & operator>>(std::istream & in, Imu & message)
{
  return in >> message.header >> message.orientation >> message.angular_velocity;
}
}  // namespace sensor_msgs::msg

namespace diagnostic_msgs::msg
{
struct KeyValue
{
  std::string key, value;
};
struct DiagnosticStatus
{
  static constexpr unsigned char OK = 0, WARN = 1, ERROR = 2, STALE = 3;
  unsigned char level = 0;
  std::string name, message, hardware_id;
  std::vector<KeyValue> values;
};
struct DiagnosticArray
{
  STUB_MESSAGE(DiagnosticArray);
  std_msgs::msg::Header header;
  std::vector<DiagnosticStatus> status;
};
inline std::ostream & operator<<(std::ostream & out, const DiagnosticArray & message)
{
  for (const DiagnosticStatus & status : message.status) {
    out << int{status.level} << ' ' << status.name << '|' << status.message << '|' << status.hardware_id;
    for (const KeyValue & pair : status.values) {out << '|' << pair.key << '=' << pair.value;}
  }
  return out;
}
}  // namespace diagnostic_msgs::msg

namespace rcl_interfaces::msg
{
struct FloatingPointRange
{
  double from_value = 0.0, to_value = 0.0, step = 0.0;
};
struct ParameterDescriptor
{
  std::string name, description, additional_constraints;
  bool read_only = false, dynamic_typing = false;
  std::vector<FloatingPointRange> floating_point_range;
};
struct SetParametersResult
{
  bool successful = false;
  std::string reason;
};
}  // namespace rcl_interfaces::msg
