// Points of data packets as ROS 1's velodyne_pointcloud has them: MODEL CALIBRATION < payloads > rows.
//
// A row is six float32: x, y, z in m, intensity, ring, number of the packet. Each packet is unpacked as a scan of its own, by the
// driver's RawData into the driver's PointcloudXYZIRT.
#include <array>
#include <cstdio>

#include <ros/time.h>
#include <velodyne_pointcloud/pointcloudXYZIRT.h>
#include <velodyne_pointcloud/rawdata.h>

int main(int count, char** words) {
  if (count != 3) {
    return 2;
  }
  ros::Time::init();
  velodyne_rawdata::RawData data;
  std::FILE* rows = fdopen(dup(STDOUT_FILENO), "wb");
  std::freopen("/dev/null", "w", stdout);  // the driver prints its table of times
  if (data.setupOffline(words[2], words[1], 300.0, 0.01) != 0) {
    return 1;
  }
  data.setParameters(0.01, 300.0, 0.0, 2 * M_PI);
  auto scan = boost::make_shared<velodyne_msgs::VelodyneScan>();
  scan->packets.resize(1);
  velodyne_msgs::VelodynePacket& packet = scan->packets.front();
  velodyne_pointcloud::PointcloudXYZIRT cloud(300.0, 0.01, "", "", data.scansPerPacket());
  for (float place = 0.0F; std::fread(packet.data.data(), packet.data.size(), 1, stdin) == 1; ++place) {
    cloud.setup(scan);
    data.unpack(packet, cloud, packet.stamp);
    const sensor_msgs::PointCloud2& found = cloud.finishCloud();
    sensor_msgs::PointCloud2ConstIterator<float> x(found, "x");
    sensor_msgs::PointCloud2ConstIterator<float> intensity(found, "intensity");
    sensor_msgs::PointCloud2ConstIterator<uint16_t> ring(found, "ring");
    for (unsigned number = 0; number < found.width; ++number, ++x, ++intensity, ++ring) {
      const std::array<float, 6> row{x[0], x[1], x[2], *intensity, static_cast<float>(*ring), place};
      std::fwrite(row.data(), sizeof(float), row.size(), rows);
    }
  }
  return std::fclose(rows);
}
