#pragma once  // Nebula's decoders name the type, and use nothing of it
namespace velodyne_msgs::msg {
struct VelodynePacket {};
}  // namespace velodyne_msgs::msg
