// Points of data packets as Nebula's decoders have them: MODEL CALIBRATION < payloads > rows.
//
// MODEL is vlp16, vlp32 or vls128. A row is six float32: x, y, z in m, intensity, ring, number of the packet.
#include <array>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include <nebula_decoders/nebula_decoders_velodyne/decoders/vlp16_decoder.hpp>
#include <nebula_decoders/nebula_decoders_velodyne/decoders/vlp32_decoder.hpp>
#include <nebula_decoders/nebula_decoders_velodyne/decoders/vls128_decoder.hpp>

using namespace nebula::drivers;

template <class Decoder>
struct Open : Decoder {
  using Decoder::Decoder;
  NebulaPointCloud& cloud() { return *this->scan_pc_; }
};

template <class Decoder>
int read(const std::shared_ptr<VelodyneSensorConfiguration>& sensor,
         const std::shared_ptr<VelodyneCalibrationConfiguration>& calibration) {
  auto decoder = std::make_unique<Open<Decoder>>(sensor, calibration);
  std::vector<uint8_t> packet(g_packet_size);
  for (float place = 0.0F; std::fread(packet.data(), packet.size(), 1, stdin) == 1; ++place) {
    decoder->unpack(packet, place * 1e-3);
    for (const NebulaPoint& point : decoder->cloud().points) {
      const std::array<float, 6> row{point.x, point.y, point.z, static_cast<float>(point.intensity),
                                     static_cast<float>(point.channel), place};
      std::fwrite(row.data(), sizeof(float), row.size(), stdout);
    }
    decoder->cloud().points.clear();
  }
  return std::fflush(stdout);
}

int main(int count, char** words) {
  if (count != 3) {
    return 2;
  }
  auto sensor = std::make_shared<VelodyneSensorConfiguration>();
  sensor->min_range = 0.01;
  sensor->max_range = 300.0;
  sensor->cloud_min_angle = 0;
  sensor->cloud_max_angle = 360;
  auto calibration = std::make_shared<VelodyneCalibrationConfiguration>();
  if (calibration->load_from_file(words[2]) != nebula::Status::OK) {
    return 1;
  }
  const std::string model = words[1];
  if (model == "vlp16") {
    return read<vlp16::Vlp16Decoder>(sensor, calibration);
  }
  if (model == "vlp32") {
    return read<vlp32::Vlp32Decoder>(sensor, calibration);
  }
  return read<vls128::Vls128Decoder>(sensor, calibration);
}
