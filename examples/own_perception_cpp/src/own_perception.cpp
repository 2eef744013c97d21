// Perception node in C++ with rclcpp, sensor_msgs and taxinet_msgs. Like ../my_perception_package, it
// implements the contract of docs/own_nodes.md.

#include <chrono>
#include <cstdint>
#include <memory>
#include <set>
#include <string>

#include "centreline.hpp"
#include "rclcpp/rclcpp.hpp"
#include "sensor_msgs/msg/image.hpp"
#include "taxinet_msgs/msg/node_status.hpp"
#include "taxinet_msgs/msg/scenario.hpp"
#include "taxinet_msgs/msg/tracking_error.hpp"

namespace own_perception
{

using sensor_msgs::msg::Image;
using taxinet_msgs::msg::NodeStatus;
using taxinet_msgs::msg::Scenario;
using taxinet_msgs::msg::TrackingError;

constexpr std::int64_t kStepNs = 100'000'000;

class OwnPerception : public rclcpp::Node
{
public:
  OwnPerception()
  : Node("perception")
  {
    const rclcpp::QoS each_step(16);  // reliable, volatile
    const auto latched = rclcpp::QoS(16).transient_local();
    status_ = create_publisher<NodeStatus>("node_status", latched);
    estimates_ = create_publisher<TrackingError>("perception/tracking_error", each_step);
    images_ = create_subscription<Image>(
      "camera/image_raw", each_step, [this](const Image & image) {see(image);});
    scenarios_ = create_subscription<Scenario>(
      "scenario", latched, [this](const Scenario & scenario) {begin(scenario);});
    timer_ = create_wall_timer(std::chrono::milliseconds(20), [this] {get_ready();});
  }

private:
  // Begins a run; a perception with state resets it here.
  void begin(const Scenario & scenario)
  {
    const std::set<std::string> present(scenario.participants.begin(), scenario.participants.end());
    if (present.count(get_name())) {
      wanted_ = 1;  // the simulator
      for (const char * name : {"steering_controller", "mtl_monitor", "recorder"}) {
        wanted_ += present.count(name);
      }
      next_run_ = scenario.run_id;
    }
  }

  // Reports READY once per run, when all connections are established.
  void get_ready()
  {
    if (next_run_.empty() || estimates_->get_subscription_count() < wanted_ ||
      images_->get_publisher_count() == 0)
    {
      return;
    }
    run_id_.swap(next_run_);
    next_run_.clear();
    NodeStatus ready;
    ready.run_id = run_id_;
    ready.node = get_name();
    ready.state = NodeStatus::READY;
    ready.implementation = "runway lines";
    ready.listens = {"camera/image_raw", "scenario"};
    status_->publish(ready);
  }

  // Publishes one estimate per frame; the control step follows from the frame's stamp.
  void see(const Image & image)
  {
    TrackingError answer;
    answer.header.stamp = image.header.stamp;
    answer.header.frame_id = "map";
    answer.run_id = run_id_;
    answer.seq = rclcpp::Time(image.header.stamp).nanoseconds() / kStepNs;
    if (image.encoding == "rgb8" && image.height == kHeight && image.width == kWidth &&
      image.data.size() == kFrameBytes)
    {
      const auto found = centreline(paint(image.data.data()));
      answer.valid = found.valid;
      answer.cross_track_error = found.cross_track_error;
      answer.heading_error = found.heading_error;
    }
    estimates_->publish(answer);
  }

  rclcpp::Publisher<NodeStatus>::SharedPtr status_;
  rclcpp::Publisher<TrackingError>::SharedPtr estimates_;
  rclcpp::Subscription<Image>::SharedPtr images_;
  rclcpp::Subscription<Scenario>::SharedPtr scenarios_;
  rclcpp::TimerBase::SharedPtr timer_;
  std::string run_id_, next_run_;
  std::size_t wanted_ = 0;
};

}  // namespace own_perception

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<own_perception::OwnPerception>());
  rclcpp::shutdown();
}
