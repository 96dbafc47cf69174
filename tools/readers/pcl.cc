// Points of a capture as PCL's grabbers have them: hdl|vlp CAPTURE > rows.
//
// A row is six float32: x, y, z in m, intensity, and -1 for ring and packet, which PCL does not say. Points are of
// whole sweeps: PCL gives a sweep when the next one begins, so the last one of a file is not seen.
#include <array>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <functional>
#include <memory>
#include <string>
#include <thread>

#include <pcl/io/hdl_grabber.h>
#include <pcl/io/vlp_grabber.h>

using Cloud = pcl::PointCloud<pcl::PointXYZI>;

int main(int count, char** words) {
  if (count != 3) {
    return 2;
  }
  std::unique_ptr<pcl::HDLGrabber> grabber;
  if (std::string(words[1]) == "vlp") {
    grabber = std::make_unique<pcl::VLPGrabber>(std::string(words[2]));
  } else {
    grabber = std::make_unique<pcl::HDLGrabber>("", std::string(words[2]));
  }
  std::atomic<int> sweeps{0};
  std::function<void(const Cloud::ConstPtr&)> keep = [&sweeps](const Cloud::ConstPtr& sweep) {
    ++sweeps;
    for (const pcl::PointXYZI& point : *sweep) {
      const std::array<float, 6> row{point.x, point.y, point.z, point.intensity, -1.0F, -1.0F};
      std::fwrite(row.data(), sizeof(float), row.size(), stdout);
    }
  };
  grabber->registerCallback(keep);
  grabber->start();
  // The grabber plays the file at the speed of its stamps, and does not say that it is at its end.
  for (int seen = -1; seen != sweeps;) {
    seen = sweeps;
    std::this_thread::sleep_for(std::chrono::seconds(2));
  }
  grabber->stop();
  return std::fflush(stdout);
}
