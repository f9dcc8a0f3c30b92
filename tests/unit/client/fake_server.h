// An in-process server of the contract, as simple as serves the client's tests.

#ifndef TESTS_UNIT_CLIENT_FAKE_SERVER_H_
#define TESTS_UNIT_CLIENT_FAKE_SERVER_H_

#include <memory>
#include <string>

#include "grpc/health/v1/health.grpc.pb.h"
#include "grpcpp/server.h"
#include "grpcpp/server_builder.h"
#include "tests/unit/client/fake_behaviour.h"
#include "tests/unit/client/fake_mesh_service.h"
#include "tests/unit/client/fake_ray_service.h"

namespace deltaray {

class FakeHealthService : public grpc::health::v1::Health::Service {
 public:
  FakeBehaviour* behaviour;

  grpc::Status Check(grpc::ServerContext*, const grpc::health::v1::HealthCheckRequest*,
                     grpc::health::v1::HealthCheckResponse* response) override {
    if (behaviour->health_failures-- > 0) return behaviour->lost;
    response->set_status(grpc::health::v1::HealthCheckResponse::SERVING);
    return grpc::Status::OK;
  }
};

// Listens on a free loopback port from construction to destruction.
class FakeServer {
 public:
  FakeServer() {
    mesh_service.behaviour = &behaviour;
    ray_service.behaviour = &behaviour;
    health_service.behaviour = &behaviour;
    int port = 0;
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(&mesh_service);
    builder.RegisterService(&ray_service);
    builder.RegisterService(&health_service);
    builder.SetMaxReceiveMessageSize(64 << 20);
    server_ = builder.BuildAndStart();
    address_ = "127.0.0.1:" + std::to_string(port);
  }

  ~FakeServer() { Stop(); }

  // From here on nobody listens.
  void Stop() { server_->Shutdown(); }

  const std::string& address() const { return address_; }

  FakeBehaviour behaviour;
  FakeMeshService mesh_service;
  FakeRayService ray_service;
  FakeHealthService health_service;

 private:
  std::unique_ptr<grpc::Server> server_;
  std::string address_;
};

}  // namespace deltaray

#endif  // TESTS_UNIT_CLIENT_FAKE_SERVER_H_
